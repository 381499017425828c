"""Tables: columns with units, declared once; the scene; what was lost."""
