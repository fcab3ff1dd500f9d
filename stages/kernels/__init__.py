"""Pure functions on arrays. Importing them puts OpenCV on one thread, as every kernel is.

A stage has its core to itself; a second thread inside it would take another stage's, unseen by the
books that say which stage used how much CPU.
"""

import cv2

cv2.setNumThreads(1)
