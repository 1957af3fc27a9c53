"""The window of keyframes: everything that outlasts an image."""
