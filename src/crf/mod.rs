//! Stage 6, crf: the energy of the paper and its minimum cut, stoppable at any time.
