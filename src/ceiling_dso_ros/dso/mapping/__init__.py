"""What happens to the window when images are traced and keyframes are made."""
