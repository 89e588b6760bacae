"""The stages of the method: datasets in, datasets out, lazy."""
