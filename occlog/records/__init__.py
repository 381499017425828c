"""Tables: columns with units, declared once; the scene; losses."""
