"""The serial link to the Teensy: framing, records, port, pings, health."""
