"""[Lee] Sec. 5.2.2: navigation in potential fields, collisions in line with the goal, escape from oscillation."""
