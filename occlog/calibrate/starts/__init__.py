"""Initial poses and focal lengths: from paths of people, their boxes, or marked points."""
