"""The window of keyframes: all state that is kept between images."""
