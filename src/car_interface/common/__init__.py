"""What every part uses: errors, parameters, stale inputs, lookup tables, files. No ROS, no device."""
