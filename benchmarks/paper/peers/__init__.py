"""The mesh methods that the paper compares with: displacement and Laplacian editing."""
