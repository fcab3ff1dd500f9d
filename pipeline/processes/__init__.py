"""A graph in several processes: started, watched over, and told of as one."""
