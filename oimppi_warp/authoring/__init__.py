"""Writing scenes: tasks, objects and robots as standard USD files."""
