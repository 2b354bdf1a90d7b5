"""What a process takes from the machine: devices, threads, memory, OpenGL, other processes, extras."""
