"""Navigation in potential fields: forces of goal and obstacles, prevention of collisions, escape from oscillation."""
