"""zfall: a small humanoid that learns to stay up when it is pushed, and to fall well."""
