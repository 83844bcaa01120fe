!> Conversion of a vector of numbers to a polynomial system or to the elements of a structure, and
!! their kernels. A polynomial system:
!!
!!   n, n_springs, n_monomials, n_kernels, factor of all kernels; M (n^2); C (n^2); base direction
!!   (n); for each spring: kernel, K (n^2); for each monomial: coefficient, equation, kernel, powers
!!   (n); for each kernel: kind, number of data, data; number of nonpolynomial laws, and each law
!!   (`new_law_term`); absolute damping and stiffness (n^2 each; see `space_damping`); gyroscopic,
!!   circulatory and centrifugal matrix (n^2 each). The last three parts may be missing. If the laws
!!   are there, either of the last two parts may be missing.
!!
!! Elements:
!!
!!   number of coordinates n, of elements, of kernels; for each element: kernel (0: none),
!!   stiffness, damping, stiffness and rate r in series (0: none), coefficients of d^2 to d^15,
!!   direction (n), direction of the deflection of an element in series (n), number of
!!   nonpolynomial laws, and each law (`new_law_term`, for one coordinate); the kernels as above.
!!
!! Matrices are in column-major order.
module viscovib_system_vector
  use viscovib_checks, only: check_finite
  use viscovib_kernel_holder, only: kernel_holder
  use viscovib_kinds, only: wp
  use viscovib_number_reader, only: number_reader
  use viscovib_polynomial, only: max_degree, new_polynomial, polynomial_parameters, polynomial_type
  use viscovib_status, only: status_type
  use viscovib_structure_elements, only: element_type
  implicit none
  private

  public :: elements_from_vector, polynomial_from_vector

contains

  subroutine polynomial_from_vector(system, vector, status)
    type(polynomial_type), intent(out) :: system
    real(wp), intent(in) :: vector(:)
    type(status_type), intent(out) :: status
    type(number_reader) :: next
    type(polynomial_parameters) :: p
    type(kernel_holder), allocatable :: kernels(:)
    real(wp) :: factor(1)
    integer :: i, n, n_springs, n_monomials, n_kernels

    call next%start(vector, 5, 'polynomial system', status)
    if (status%failed()) return
    n = next%whole()
    n_springs = next%whole()
    n_monomials = next%whole()
    n_kernels = next%whole()
    factor = next%row(1)
    p%mass = next%matrix(n, n)
    p%damping = next%matrix(n, n)
    p%base_direction = next%row(n)
    allocate (p%stiffness(n, n, n_springs), p%spring_kernel(n_springs))
    do i = 1, n_springs
      p%spring_kernel(i) = next%whole()
      p%stiffness(:, :, i) = next%matrix(n, n)
    end do
    allocate (p%coefficient(n_monomials), p%on(n_monomials), p%monomial_kernel(n_monomials), &
              p%powers(n, n_monomials))
    do i = 1, n_monomials
      p%coefficient(i:i) = next%row(1)
      p%on(i) = next%whole()
      p%monomial_kernel(i) = next%whole()
      p%powers(:, i) = nint(next%row(n))
    end do
    call next%kernels(n_kernels, kernels, status)
    if (status%failed()) return
    kernels%factor = factor(1)
    if (next%count_left() > 0) call next%laws(n, p%laws)
    if (any(next%count_left() == [2, 5]*n*n)) then
      p%space_damping = next%matrix(n, n)
      p%space_stiffness = next%matrix(n, n)
    end if
    if (next%count_left() > 0) then
      p%gyroscopic = next%matrix(n, n)
      p%circulatory = next%matrix(n, n)
      p%centrifugal = next%matrix(n, n)
    end if
    call check_finite('memory_scale', factor, status)
    if (status%failed()) return
    call new_polynomial(system, p, kernels, status)
  end subroutine polynomial_from_vector

  subroutine elements_from_vector(elements, kernels, vector, status)
    type(element_type), allocatable, intent(out) :: elements(:)
    type(kernel_holder), allocatable, intent(out) :: kernels(:)
    real(wp), intent(in) :: vector(:)
    type(status_type), intent(out) :: status
    type(number_reader) :: next
    real(wp) :: head(4 + max_degree)
    integer :: i, n, n_kernels

    call next%start(vector, 3, 'list of elements', status)
    if (status%failed()) return
    n = next%whole()
    allocate (elements(next%whole()))
    n_kernels = next%whole()
    do i = 1, size(elements)
      associate (one => elements(i))
        head = next%row(size(head))
        one%kernel = nint(head(1))
        one%stiffness = head(2)
        one%damping = head(3)
        one%series = [head(4), 0.0_wp, 0.0_wp, head(5)]
        one%powers = head(6:)
        one%direction = next%row(n)
        one%across = next%row(n)
        call next%laws(1, one%laws)
      end associate
    end do
    call next%kernels(n_kernels, kernels, status)
  end subroutine elements_from_vector

end module viscovib_system_vector
