"""What every device has in common: the protocol, addresses, nodes, time stamps."""
