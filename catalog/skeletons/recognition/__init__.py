"""Recognition of bodies by names, structure and geometry, where no skeleton mapping fits the names."""
