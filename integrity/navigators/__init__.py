"""From measurements to belief: navigators, and the solution that each of them gives."""
