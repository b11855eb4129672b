"""Fields over the table and over the object's poses: distances and the cost-to-go."""
