"""The Teensy sensor hub: wheel odometer, six sonars, ping and error counters over a framed serial link."""
