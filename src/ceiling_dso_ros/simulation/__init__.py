"""Simulates a robot under a ceiling with its camera, wheels and other sensors: from Python, or into a bag."""
