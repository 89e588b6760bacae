"""The sensor: levels, defects, what a frame shows, and every pixel sent to its view (METHOD 5 and 7)."""
