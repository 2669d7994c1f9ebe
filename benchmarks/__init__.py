"""What others would use on the same work; not installed. ``recipes.bench`` measures it."""
