"""ONNX graphs: sessions, recurrence, folding."""
