"""Between processes: what carries values, and what keeps a process alive."""
