"""Decoders in processes of their own: started or forked, their jobs, and the memory that images come through."""
