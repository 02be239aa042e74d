"""All drawing: pages that need nothing else, pictures and films of motions, and the stages that only draw."""
