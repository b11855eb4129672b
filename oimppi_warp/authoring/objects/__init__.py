"""Objects to be pushed: flat shapes, letters and words, and meshes made fit for it."""
