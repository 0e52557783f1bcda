"""What the flight library costs, counted in instructions (`make count`)."""
