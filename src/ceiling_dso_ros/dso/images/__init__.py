"""What is made of an image: its pyramid, samples between pixels, the pixels worth tracking."""
