"""How sure the smoothed tracks are: of who is who, of places, and of when somebody was there."""
