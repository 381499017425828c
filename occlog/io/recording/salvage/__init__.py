"""What is whole in a recording that is damaged, and a whole recording made of it."""
