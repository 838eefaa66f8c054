// Tests the triangles of a leaf or cell. Included by the traversals of this folder.
//
// All files here are compiled twice: as GLSL by kernels/shaders/*.comp, and as C++ by
// accel/trace_cpu.cpp, inside a class. Both supply what the text uses: load_*(), test_triangle(),
// count_*(), and the constants has_refs and stack_size.
#ifndef ENERGYPROF_TRAVERSAL_LEAF_H
#define ENERGYPROF_TRAVERSAL_LEAF_H

EP_FN Hit test_leaf(Hit best, Ray ray, uint first, uint count) {
  if (!has_refs) return test_triangle(best, ray, first);
  for (uint i = first; i < first + count; ++i) {
    count_step();
    best = test_triangle(best, ray, load_ref(i));
  }
  return best;
}

#endif
