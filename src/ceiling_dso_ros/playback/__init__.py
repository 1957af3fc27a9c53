"""One run over a recording: the odometry, the fusion beside it, and what is kept of them."""
