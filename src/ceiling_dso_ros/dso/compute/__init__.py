"""What the odometry computes with: compiled kernels, structs of arrays, linear systems, times and threads."""
