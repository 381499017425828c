"""What cameras and microphone arrays measure of simulated targets."""
