"""Method `jipda`: all people on the floor, from the boxes of all cameras jointly, among people who hide one another."""
