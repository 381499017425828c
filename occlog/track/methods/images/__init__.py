"""Methods that track ellipses in the images of several cameras."""
