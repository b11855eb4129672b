"""The viewer: a session or a record produces pictures, and one canvas draws them in the browser or into a file."""
