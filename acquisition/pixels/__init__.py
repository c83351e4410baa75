"""Image files, their pixels, and measurements of image quality."""
