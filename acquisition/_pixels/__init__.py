"""Image files, their pixels, and what is measured on them."""
