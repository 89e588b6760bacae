"""Disparity of full-colour views: their layers, the search, and the refinement over all views that see a place."""
