!> Conversion of a vector of numbers to a polynomial system and its kernels:
!!
!!   n, n_springs, n_monomials, n_kernels, factor of all kernels; M (n^2); C (n^2); base direction
!!   (n); for each spring: kernel, K (n^2); for each monomial: coefficient, equation, kernel, powers
!!   (n); for each kernel: kind, number of data, data; number of nonpolynomial laws, and each law
!!   (`new_law_term`); absolute damping and stiffness (n^2 each; see `space_damping`); gyroscopic,
!!   circulatory and centrifugal matrix (n^2 each). The last three parts may be missing. If the laws
!!   are there, either of the last two parts may be missing.
!!
!! Matrices are in column-major order.
module viscovib_system_vector
  use viscovib_catalogue, only: new_kernel
  use viscovib_checks, only: check_finite
  use viscovib_kernel_holder, only: kernel_holder
  use viscovib_kinds, only: wp
  use viscovib_law_term, only: new_law_term
  use viscovib_polynomial, only: new_polynomial, polynomial_parameters, polynomial_type
  use viscovib_status, only: fail, set_ok, status_input_error, status_type
  implicit none
  private

  public :: kernels_from_vector, polynomial_from_vector

contains

  subroutine polynomial_from_vector(system, vector, status)
    type(polynomial_type), intent(out) :: system
    real(wp), intent(in) :: vector(:)
    type(status_type), intent(out) :: status
    type(polynomial_parameters) :: p
    type(kernel_holder), allocatable :: kernels(:)
    integer :: at, i, n, n_springs, n_monomials, n_kernels, n_data

    if (size(vector) < 5) then
      call fail(status, status_input_error, 'system', 'system: not a polynomial system')
      return
    end if
    n = nint(vector(1))
    n_springs = nint(vector(2))
    n_monomials = nint(vector(3))
    n_kernels = nint(vector(4))
    at = 5
    p%mass = reshape(next(n*n), [n, n])
    p%damping = reshape(next(n*n), [n, n])
    p%base_direction = next(n)
    allocate (p%stiffness(n, n, n_springs), p%spring_kernel(n_springs))
    do i = 1, n_springs
      p%spring_kernel(i:i) = nint(next(1))
      p%stiffness(:, :, i) = reshape(next(n*n), [n, n])
    end do
    allocate (p%coefficient(n_monomials), p%on(n_monomials), p%monomial_kernel(n_monomials), &
              p%powers(n, n_monomials))
    do i = 1, n_monomials
      p%coefficient(i:i) = next(1)
      p%on(i:i) = nint(next(1))
      p%monomial_kernel(i:i) = nint(next(1))
      p%powers(:, i) = nint(next(n))
    end do
    call kernels_from_vector(kernels, n_kernels, vector, at, status)
    if (status%failed()) return
    kernels%factor = vector(5)
    if (at < size(vector)) then
      allocate (p%laws(nint(vector(at + 1))))
      at = at + 1
      do i = 1, size(p%laws)
        call new_law_term(p%laws(i), vector(at + 1:), n, n_data)
        at = at + n_data
      end do
    end if
    if (size(vector) - at == 2*n*n .or. size(vector) - at == 5*n*n) then
      p%space_damping = reshape(next(n*n), [n, n])
      p%space_stiffness = reshape(next(n*n), [n, n])
    end if
    if (at < size(vector)) then
      p%gyroscopic = reshape(next(n*n), [n, n])
      p%circulatory = reshape(next(n*n), [n, n])
      p%centrifugal = reshape(next(n*n), [n, n])
    end if
    call check_finite('memory_scale', vector(5:5), status)
    if (status%failed()) return
    call new_polynomial(system, p, kernels, status)

  contains

    !> The next count numbers.
    function next(count) result(values)
      integer, intent(in) :: count
      real(wp) :: values(count)
      values = vector(at + 1:at + count)
      at = at + count
    end function next

  end subroutine polynomial_from_vector

  !> Read kernels: of each its kind, the number of its data, and these.
  subroutine kernels_from_vector(kernels, n, vector, at, status)
    type(kernel_holder), allocatable, intent(out) :: kernels(:)
    integer, intent(in) :: n
    real(wp), intent(in) :: vector(:)
    !> Number of entries read before, and after.
    integer, intent(inout) :: at
    type(status_type), intent(out) :: status
    integer :: i, n_data

    call set_ok(status)
    allocate (kernels(n))
    do i = 1, n
      n_data = nint(vector(at + 2))
      call new_kernel(kernels(i)%kernel, nint(vector(at + 1)), vector(at + 3:at + 2 + n_data), &
                      status)
      if (status%failed()) return
      at = at + 2 + n_data
    end do
  end subroutine kernels_from_vector

end module viscovib_system_vector
