"""Everything between a small autonomous car's software and its hardware."""
