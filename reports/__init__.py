"""Reports: self-contained HTML pages, pictures and films of motions, and the stages that write them."""
