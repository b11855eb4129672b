"""All that would stop or spoil a run of a scene, found before it is run."""
