"""Disparity of a mosaicked light field: same-colour costs, fusion, refinement and error map (METHOD 8)."""
