!> Conversion of a vector of numbers to elements of a structure and their kernels:
!!
!!   number of coordinates n, of elements, of kernels; for each element: kernel (0: none),
!!   stiffness, damping, stiffness and rate r in series (0: none), coefficients of d^2 to d^15,
!!   direction (n), direction of the deflection of an element in series (n), number of
!!   nonpolynomial laws, and each law (`new_law_term`, for one coordinate); the kernels
!!   (`kernels_from_vector`).
module viscovib_element_vector
  use viscovib_kernel_holder, only: kernel_holder
  use viscovib_kinds, only: wp
  use viscovib_law_term, only: new_law_term
  use viscovib_polynomial, only: max_degree
  use viscovib_status, only: status_type
  use viscovib_structure_elements, only: element_type
  use viscovib_system_vector, only: kernels_from_vector
  implicit none
  private

  public :: elements_from_vector

contains

  subroutine elements_from_vector(elements, kernels, vector, status)
    type(element_type), allocatable, intent(out) :: elements(:)
    type(kernel_holder), allocatable, intent(out) :: kernels(:)
    real(wp), intent(in) :: vector(:)
    type(status_type), intent(out) :: status
    real(wp) :: head(4 + max_degree)
    integer :: at, i, j, n, used

    n = nint(vector(1))
    allocate (elements(nint(vector(2))))
    at = 3
    do i = 1, size(elements)
      associate (one => elements(i))
        head = next(size(head))
        one%kernel = nint(head(1))
        one%stiffness = head(2)
        one%damping = head(3)
        one%series = [head(4), 0.0_wp, 0.0_wp, head(5)]
        one%powers = head(6:)
        one%direction = next(n)
        one%across = next(n)
        head(:1) = next(1)
        allocate (one%laws(nint(head(1))))
        do j = 1, size(one%laws)
          call new_law_term(one%laws(j), vector(at + 1:), 1, used)
          at = at + used
        end do
      end associate
    end do
    call kernels_from_vector(kernels, nint(vector(3)), vector, at, status)

  contains

    function next(count) result(values)
      integer, intent(in) :: count
      real(wp) :: values(count)
      values = vector(at + 1:at + count)
      at = at + count
    end function next

  end subroutine elements_from_vector

end module viscovib_element_vector
