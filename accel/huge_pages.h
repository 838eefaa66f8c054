/// Large arrays on huge pages: a build touches some hundred megabytes for the first time, and a
/// page fault costs about as much as writing the page.
#pragma once

#include <sys/mman.h>

#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <memory>
#include <new>
#include <type_traits>

namespace energyprof::accel {

inline constexpr size_t huge_page_bytes = size_t{2} << 20;

/// Asks for huge pages in memory not touched yet. Only a wish: without effect where the system
/// gives none, and for less than two of them.
inline void prefer_huge_pages(void* memory, size_t byte_count) {
  constexpr uintptr_t page_bytes = 4096;
  if (byte_count < 2 * huge_page_bytes) return;
  const uintptr_t begin =
      (reinterpret_cast<uintptr_t>(memory) + page_bytes - 1) & ~(page_bytes - 1);
  const uintptr_t end = (reinterpret_cast<uintptr_t>(memory) + byte_count) & ~(page_bytes - 1);
#ifdef MADV_HUGEPAGE
  static_cast<void>(madvise(reinterpret_cast<void*>(begin), end - begin, MADV_HUGEPAGE));
#endif
}

struct FreeMemory {
  void operator()(void* memory) const { std::free(memory); }
};
/// An array whose elements are not filled in.
template <class T>
using RawArray = std::unique_ptr<T[], FreeMemory>;

template <class T>
RawArray<T> make_raw_array(size_t count) {
  static_assert(std::is_trivially_destructible_v<T>);
  const size_t byte_count = count * sizeof(T);
  const bool is_large = byte_count >= 2 * huge_page_bytes;
  const size_t alignment = is_large ? huge_page_bytes : 64;
  const size_t padded_count = (byte_count / alignment + 1) * alignment;
  void* memory = std::aligned_alloc(alignment, padded_count);
  if (memory == nullptr) throw std::bad_alloc();
  prefer_huge_pages(memory, byte_count);
  return RawArray<T>(static_cast<T*>(memory));
}

}  // namespace energyprof::accel
