"""One run over a recording: odometry, fusion, and their results."""
