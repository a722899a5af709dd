// Included at the end of a .cpp file that has defined NMP_INSTANTIATE(Real), and meant to be
// included many times. A test that includes such a file sets NMP_TEST_SCALAR to its own scalar
// first.
#ifdef NMP_TEST_SCALAR
NMP_INSTANTIATE(NMP_TEST_SCALAR)
#else
NMP_INSTANTIATE(float)
NMP_INSTANTIATE(double)
#endif
#undef NMP_INSTANTIATE
