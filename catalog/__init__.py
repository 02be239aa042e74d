"""This package defines skeleton mappings, feature sets and their bit layout, classes, queries, and the SQL views."""
