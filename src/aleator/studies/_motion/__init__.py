"""What the studies of motion planning share: their stages, what they find, and how they tell it."""
