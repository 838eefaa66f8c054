# Puts a file into the program, byte by byte, so that nothing has to be found at run time.
#
#   energyprof_embed(TARGET name FILE path)
#
# gives TARGET a header "embedded/<name>.h" with `std::string_view energyprof::embedded::<name>()`.
# The bytes are 16-byte aligned and followed by a NUL.
function(energyprof_embed target name file)
  set(dir ${CMAKE_CURRENT_BINARY_DIR}/embedded)
  set(asm ${dir}/${name}.S)
  file(MAKE_DIRECTORY ${dir})
  file(CONFIGURE OUTPUT ${asm} @ONLY CONTENT [[
    .section .rodata
    .balign 16
    .global energyprof_embedded_@name@
    .global energyprof_embedded_@name@_end
energyprof_embedded_@name@:
    .incbin "@file@"
energyprof_embedded_@name@_end:
    .byte 0
    .section .note.GNU-stack,"",%progbits
]])
  file(CONFIGURE OUTPUT ${dir}/${name}.h @ONLY CONTENT [[
#pragma once
#include <string_view>
extern "C" const char energyprof_embedded_@name@[];
extern "C" const char energyprof_embedded_@name@_end[];
namespace energyprof::embedded {
inline std::string_view @name@() {
  return {energyprof_embedded_@name@,
          static_cast<std::size_t>(energyprof_embedded_@name@_end - energyprof_embedded_@name@)};
}
}  // namespace energyprof::embedded
]])
  set_source_files_properties(${asm} PROPERTIES OBJECT_DEPENDS ${file})
  target_sources(${target} PRIVATE ${asm})
  target_include_directories(${target} PRIVATE ${CMAKE_CURRENT_BINARY_DIR})
endfunction()
