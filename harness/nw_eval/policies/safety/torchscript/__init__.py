"""What a TorchScript archive may hold."""
