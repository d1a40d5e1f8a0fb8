"""The lowest floor: data types, plane arithmetic, time, chance, padding, devices, and sentences about wrong values."""
