"""Labels of people: kept in a store, compared with annotations, and taken from label files."""
