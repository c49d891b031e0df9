"""What an ONNX file may hold."""
