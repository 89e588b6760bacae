"""Pictures out of samples: colours completed along the disparity, views, refocusing (METHOD 9 and 4)."""
