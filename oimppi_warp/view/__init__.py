"""The viewer: what is shown is made by a session or a record, drawn by one canvas, in the browser or into a file."""
