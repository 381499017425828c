"""The experiments of Qu, Schonfeld and Mohamed (2007)."""
