"""Bytes to and from an instrument: a serial port, a TCP connection, or a recorded transcript of either."""
