"""Decoders in separate processes: started or forked, their jobs, and the memory that images come through."""
