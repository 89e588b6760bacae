"""The lattice of the subimages (METHOD 6): the first one, centres, fit, likelihood, and what bends or dims it."""
