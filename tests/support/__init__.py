"""What the tests share: meshes, problems, checks, and twins of the laws that share no formula."""
