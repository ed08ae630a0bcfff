"""Work and time over ranks."""
