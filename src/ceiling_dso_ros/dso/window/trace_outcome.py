"""What the last trace of a candidate point ended with."""

UNTRACED = 0
GOOD = 1
SKIPPED = 2  # the interval is already so short that a search cannot shorten it
BAD_CONDITION = 3  # the image gradient runs along the edge: the position is not observable now
OUT_OF_BOUNDS = 4
OUTLIER = 5
DELETED = 6
