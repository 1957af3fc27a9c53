"""From a recording to a trajectory, and from a trajectory to its error."""
