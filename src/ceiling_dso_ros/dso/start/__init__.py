"""The first map of a segment."""
