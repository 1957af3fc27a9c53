"""A robot under a factory roof: ceilings, camera, wheels and sensors, as a Python API and as a bag."""
