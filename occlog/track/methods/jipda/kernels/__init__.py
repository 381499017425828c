"""Boxes of upright bodies, cover among people, association by belief propagation, updates; arrays in, arrays out."""
