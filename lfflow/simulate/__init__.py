"""A forward model of a plenoptic camera."""
