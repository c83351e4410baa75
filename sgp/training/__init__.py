"""Training of the networks of super-resolution; torch and onnx are imported only where they run."""
