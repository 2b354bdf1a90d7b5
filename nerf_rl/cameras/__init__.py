"""Camera matrices, and which cameras a rig has; nothing here knows a simulator or draws."""
