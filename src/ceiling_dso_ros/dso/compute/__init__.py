"""Tools for the computation: compiled kernels, structs of arrays, linear systems, timers and threads."""
