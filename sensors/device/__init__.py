"""Protocol of all devices, addresses, device nodes, time stamps."""
