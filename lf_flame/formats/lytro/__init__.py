"""Files of Lytro cameras: containers, metadata, white images, pictures."""
