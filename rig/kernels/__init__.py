"""Compiled kernels: where they are kept, and the threads that they run in."""
