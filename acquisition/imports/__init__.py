"""Import of images from other programs and cameras into sessions."""
