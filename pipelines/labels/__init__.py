"""Labels of people: record them in a store, compare them with annotations, and import them from label files."""
