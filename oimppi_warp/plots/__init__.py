"""Pictures of an episode: plots and a film, drawn from its record alone."""
