"""The steering: turn radius to servo duty, who steers, and whether the car turns as commanded."""
