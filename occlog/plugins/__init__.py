"""Plug-ins: what they implement (`interface`), and how installed ones are found (`loading`)."""
