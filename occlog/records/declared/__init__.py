"""Declarations of the tables, by subject.

`occlog.records.tables` lists all.
"""
