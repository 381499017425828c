"""Names of files and sensors: those that outputs may have, those that libraries take, those that mean the same."""
