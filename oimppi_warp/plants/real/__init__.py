"""What all real arms have in common: commands from a thread, faults, the way to the start, the object's pose."""
