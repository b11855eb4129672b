"""Objects to be pushed: flat shapes, letters and words, and imported meshes."""
