// Argument checks shared by the bindings: an error names the argument, what it got and what it takes.
#pragma once
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <initializer_list>
#include <string>

namespace appl {
namespace nb = nanobind;
using Array = nb::ndarray<nb::device::cpu>;

inline std::string shape_text(const Array &a) {
    std::string s = "(";
    for (size_t i = 0; i < a.ndim(); ++i) s += (i ? ", " : "") + std::to_string(a.shape(i));
    return s + ")";
}

// Pointer to C-contiguous data of type T; `shape` holds the wanted extents, -1 for any.
template <typename T>
T *checked(const Array &a, const char *name, std::initializer_list<long> shape) {
    using Value = std::remove_const_t<T>;
    if (a.dtype() != nb::dtype<Value>())
        throw nb::type_error((std::string(name) + ": wrong dtype; expected a C-contiguous array of " +
                              (std::is_floating_point_v<Value> ? "float"
                               : std::is_signed_v<Value>       ? "int"
                                                               : "uint") +
                              std::to_string(8 * sizeof(Value)))
                                 .c_str());
    std::string want = "(";
    bool ok = a.ndim() == shape.size();
    size_t i = 0;
    for (long extent : shape) {
        want += (i ? ", " : "") + (extent < 0 ? std::string("n") : std::to_string(extent));
        if (ok && extent >= 0 && a.shape(i) != static_cast<size_t>(extent)) ok = false;
        ++i;
    }
    if (!ok)
        throw nb::value_error((std::string(name) + ": expected shape " + want + "), got " + shape_text(a)).c_str());
    long stride = 1;
    for (size_t k = a.size() ? a.ndim() : 0; k-- > 0;) {  // strides of nothing say nothing
        if (a.shape(k) > 1 && a.stride(k) != stride)
            throw nb::value_error((std::string(name) + ": expected a C-contiguous array").c_str());
        stride *= static_cast<long>(a.shape(k));
    }
    return static_cast<T *>(const_cast<void *>(static_cast<const void *>(a.data())));
}
}  // namespace appl
