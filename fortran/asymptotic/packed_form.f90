! Optimize: -O1
!> A polynomial form as one vector of numbers, for callers in other languages.
!!
!! n, n_dof, n_arguments, n_modes, n_loads, n_quadratic, n_cubic, memory_scale, then source,
!! derivative, kernel_of, A_0..A_2, H, quadratic terms (row, i, j, coefficient each), cubic
!! terms (row, i, j, k, coefficient each), loads, drives, omega, right, left; matrices
!! column by column.
module viscovib_packed_form
  use, intrinsic :: ieee_arithmetic, only: ieee_is_finite
  use viscovib_kernel_holder, only: copy_kernels, kernel_holder
  use viscovib_kinds, only: wp
  use viscovib_polynomial_form, only: polynomial_form_type, term_type
  use viscovib_status, only: fail, status_input_error, status_type
  implicit none
  private

  public :: pack_form, unpack_form

contains

  subroutine pack_form(form, packed)
    type(polynomial_form_type), intent(in) :: form
    real(wp), allocatable, intent(out) :: packed(:)
    real(wp) :: factor
    integer :: i

    factor = 1.0_wp
    if (size(form%kernels) > 0) factor = form%kernels(1)%factor
    packed = [real([form%n, form%n_dof, form%n_arguments, form%n_modes(), size(form%drives), &
                    size(form%quadratic), size(form%cubic)], wp), factor, &
              real(form%source, wp), real(form%derivative, wp), real(form%kernel_of, wp), &
              reshape(form%linear, [size(form%linear)]), &
              reshape(form%hereditary, [size(form%hereditary)])]
    do i = 1, size(form%quadratic)
      associate (t => form%quadratic(i))
        packed = [packed, real(t%row, wp), real(t%at(:2), wp), t%coefficient]
      end associate
    end do
    do i = 1, size(form%cubic)
      associate (t => form%cubic(i))
        packed = [packed, real(t%row, wp), real(t%at, wp), t%coefficient]
      end associate
    end do
    packed = [packed, reshape(form%load, [size(form%load)]), form%drives, form%omega, &
              reshape(form%right, [size(form%right)]), reshape(form%left, [size(form%left)])]
  end subroutine pack_form

  !> Kernels are separate arguments, since a vector of numbers does not represent them.
  subroutine unpack_form(packed, kernels, form, status)
    real(wp), intent(in) :: packed(:)
    type(kernel_holder), intent(in) :: kernels(:)
    type(polynomial_form_type), intent(out) :: form
    type(status_type), intent(out) :: status
    integer :: head(7), n, m, modes, loads, at, i, expected

    call copy_kernels(kernels, form%kernels)
    expected = -1
    head = 0
    n = 0
    m = 0
    modes = 0
    loads = 0
    if (size(packed) >= 8) then
      if (all(ieee_is_finite(packed)) .and. all(abs(packed(:7)) < 1.0e5_wp)) then
        head = nint(packed(:7))
        n = head(1)
        m = head(3)
        modes = head(4)
        loads = head(5)
        if (all(head >= 0)) expected = 8 + 2*m + n + 4*n**2 + 4*head(6) + 5*head(7) &
                                       + loads*(n + 1) + modes*(2*n + 1)
      end if
    end if
    if (expected /= size(packed)) then
      call fail(status, status_input_error, 'form', 'form: not the numbers of a polynomial form')
      return
    end if
    form%n = n
    form%n_dof = head(2)
    form%n_arguments = m
    form%kernels%factor = packed(8)
    at = 8
    form%source = nint(next(m))
    form%derivative = nint(next(m))
    form%kernel_of = nint(next(n))
    form%linear = reshape(next(3*n**2), [n, n, 3])
    call from_zero(form%linear)
    form%hereditary = reshape(next(n**2), [n, n])
    allocate (form%quadratic(head(6)), form%cubic(head(7)))
    do i = 1, head(6)
      form%quadratic(i) = term_type(nint(packed(at + 1)), [nint(packed(at + 2:at + 3)), 0], &
                                    packed(at + 4))
      at = at + 4
    end do
    do i = 1, head(7)
      form%cubic(i) = term_type(nint(packed(at + 1)), nint(packed(at + 2:at + 4)), packed(at + 5))
      at = at + 5
    end do
    form%load = reshape(next(n*loads), [n, loads])
    form%drives = next(loads)
    form%omega = next(modes)
    form%right = reshape(next(n*modes), [n, modes])
    form%left = reshape(next(n*modes), [n, modes])
    if (any(form%kernel_of > size(kernels))) then
      call fail(status, status_input_error, 'form', 'form: a kernel that it names is not given')
    end if

  contains

    function next(length) result(part)
      integer, intent(in) :: length
      real(wp) :: part(length)
      part = packed(at + 1:at + length)
      at = at + length
    end function next

    !> The third index counts powers, from 0.
    subroutine from_zero(linear)
      real(wp), allocatable, intent(inout) :: linear(:, :, :)
      real(wp), allocatable :: moved(:, :, :)
      allocate (moved(n, n, 0:2))
      moved(:, :, 0:2) = linear(:, :, 1:3)
      call move_alloc(moved, linear)
    end subroutine from_zero

  end subroutine unpack_form

end module viscovib_packed_form
