"""Where a training step runs: processes, devices and threads, and what may go wrong there."""
