"""From a third party's checkpoint to a card that fits: `policies init` and `policies check`."""
