"""The viewer: a session or a record produces pictures, and a canvas draws them in the browser or to a file."""
