"""Detection of people in foreground regions.

Mixture of person-sized Gaussians by EM, and outlines for merged silhouettes.
"""
