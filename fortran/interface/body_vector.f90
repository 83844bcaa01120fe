!> Conversion of a vector of numbers to a body with finite rotations:
!!
!!   number of coordinates n, of springs, of kernels; loads in body axes (1); h (3); M (n^2); C
!!   (n^2); base direction (n); for each spring: kernel (0: none), rotational (1), direction (3),
!!   arm (3), stiffness, damping, static load, coordinate of its track (0: none), number of
!!   coefficients of d^2, d^3, ... and these, number of nonpolynomial laws, and each law
!!   (`new_law_term`, for one coordinate); for each kernel: kind, number of data, data.
!!
!! Matrices are in column-major order.
module viscovib_body_vector
  use viscovib_catalogue, only: new_kernel
  use viscovib_kernel_holder, only: kernel_holder
  use viscovib_kinds, only: wp
  use viscovib_law_term, only: new_law_term
  use viscovib_status, only: fail, set_ok, status_input_error, status_type
  use viscovib_turning_body, only: body_spring, new_turning_body, turning_body
  implicit none
  private

  public :: body_from_vector

contains

  subroutine body_from_vector(body, vector, status)
    type(turning_body), intent(out) :: body
    real(wp), intent(in) :: vector(:)
    type(status_type), intent(out) :: status
    type(body_spring), allocatable :: springs(:)
    type(kernel_holder), allocatable :: kernels(:)
    real(wp), allocatable :: mass(:, :), damping(:, :), direction(:)
    integer :: at, i, kind, n, n_data

    call set_ok(status)
    if (size(vector) < 7) then
      call fail(status, status_input_error, 'system', 'system: not a body')
      return
    end if
    n = nint(vector(1))
    allocate (springs(nint(vector(2))), kernels(nint(vector(3))))
    at = 7
    mass = reshape(next(n*n), [n, n])
    damping = reshape(next(n*n), [n, n])
    direction = next(n)
    do i = 1, size(springs)
      call next_spring(springs(i))
    end do
    do i = 1, size(kernels)
      kind = nint(vector(at + 1))
      n_data = nint(vector(at + 2))
      at = at + 2
      call new_kernel(kernels(i)%kernel, kind, next(n_data), status)
      if (status%failed()) return
    end do
    call new_turning_body(body, mass, damping, direction, springs, kernels)
    body%loads_turn = nint(vector(4)) == 1
    body%spin_inside = vector(5:7)

  contains

    function next(count) result(values)
      integer, intent(in) :: count
      real(wp) :: values(count)
      values = vector(at + 1:at + count)
      at = at + count
    end function next

    subroutine next_spring(spring)
      type(body_spring), intent(out) :: spring
      real(wp) :: head(13)
      integer :: j, used

      head = next(13)
      spring%kernel = nint(head(1))
      spring%turning = nint(head(2)) == 1
      spring%direction = head(3:5)
      spring%arm = head(6:8)
      spring%stiffness = head(9)
      spring%damping = head(10)
      spring%preload = head(11)
      spring%track = nint(head(12))
      spring%coefficient = next(nint(head(13)))
      head(:1) = next(1)
      allocate (spring%laws(nint(head(1))))
      do j = 1, size(spring%laws)
        call new_law_term(spring%laws(j), vector(at + 1:), 1, used)
        at = at + used
      end do
    end subroutine next_spring

  end subroutine body_from_vector

end module viscovib_body_vector
