#include "allocation_count.h"

#include <cstdlib>
#include <new>

namespace {
thread_local int64_t count_of_thread = 0;
}

// In a file of its own: inlined where they are used, the compiler would see new paired with free.
void* operator new(std::size_t byte_count) {
  ++count_of_thread;
  if (void* memory = std::malloc(byte_count == 0 ? 1 : byte_count)) return memory;
  throw std::bad_alloc();
}
void* operator new(std::size_t byte_count, const std::nothrow_t&) noexcept {
  ++count_of_thread;
  return std::malloc(byte_count == 0 ? 1 : byte_count);
}
void operator delete(void* memory) noexcept { std::free(memory); }
void operator delete(void* memory, std::size_t) noexcept { std::free(memory); }

namespace energyprof::probe {
int64_t allocation_count() { return count_of_thread; }
}  // namespace energyprof::probe
