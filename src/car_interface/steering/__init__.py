"""The steering: from a turn radius to a servo duty, who steers, and whether the car turns as commanded."""
