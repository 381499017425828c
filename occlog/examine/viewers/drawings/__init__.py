"""What is drawn in the world and over images: people, sensors, sight lines, what does not move."""
