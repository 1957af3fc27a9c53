# SPDX-License-Identifier: BSD-3-Clause
"""Limits of what is read from files and recordings, which may declare anything.

They are checked before memory is taken. Each is far above what a robot records, and low enough for a robot's computer.
"""

MOST_SETTINGS_BYTES = 100_000  # of a yaml file, camera.txt, pcalib.txt; those of the package have a few thousand
MOST_SETTINGS = 10_000  # values in a yaml file, references to others counted as what they stand for
MOST_TABLE_BYTES = 2**30  # of a trajectory, times.txt or encoders.csv: two days at 50 Hz
LONGEST_LINE = 10_000  # bytes; a pose has about 100
MOST_PIXELS = 2**26  # of an image, 64 megapixels: more than any camera has whose images could be tracked
MOST_IMAGE_BYTES = 2**28  # of an image file: the pixels above with 16 bits, not compressed, twice
MOST_SCANS = 200  # of a JPEG: progressive ones have about ten; each further one costs the time of an image
MOST_CHUNK_BYTES = 2**28  # of a bag, decompressed: recorders fill 768 kB, and one message may be larger
MOST_JOINTS = 500  # names in joint_states
MOST_FRAMES = 100  # from one frame of tf to another
LARGEST_M = 1e8  # of a position, metres or VO units: further than any map projection goes, and resolved to 15 nm
LARGEST_SET_M = LARGEST_M / 2  # of a pose that the published one is set to: the robot drives on from there
LARGEST_RAD = 1e12  # of the angle of a wheel: at 1e12 a float64 still resolves a tenth of a milliradian
MOST_RAYS = 20_000  # of a LiDAR's scan; those with the finest resolution have a few thousand
LONGEST_SCAN_LINE = 500_000  # bytes of a line with a scan
