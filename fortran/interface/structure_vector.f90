!> Conversion of a vector of numbers to a condensed structure:
!!
!!   coordinates q, real modes m, complex modes p, load harmonics; squares (m); rates (m); losses
!!   (m); seen (m q); pushed (m q); poles (p); left (p q); right (p q); flexibility,
!!   flexibility_rate and static stiffness (q^2 each); number n of uncondensed coordinates (0:
!!   none), their damping and stiffness (n^2 each), pushed and seen (n q each); for each harmonic:
!!   order; for forces and base: push on real modes (m), on complex modes (p), flexible deflections
!!   (q) and their rates (q); static load (q); number of forces that depend on the frequency, and
!!   of each the push, and the length, instructions and numbers of its law; then laws, linear
!!   stiffness of elements with a kernel, and kernels as a polynomial system
!!   (`viscovib_system_vector`), whose mass is a weight.
!!
!! Poles, left, right and loads are complex: two numbers each. Arrays are in column-major order.
module viscovib_structure_vector
  use viscovib_compliance, only: push_type
  use viscovib_kinds, only: wp
  use viscovib_status, only: fail, status_input_error, status_type
  use viscovib_structure, only: structure_type
  use viscovib_system_vector, only: polynomial_from_vector
  implicit none
  private

  public :: structure_from_vector

contains

  subroutine structure_from_vector(system, vector, status)
    type(structure_type), intent(out) :: system
    real(wp), intent(in) :: vector(:)
    type(status_type), intent(out) :: status
    integer :: at, i, j, m, n, p, q

    if (size(vector) < 4) then
      call fail(status, status_input_error, 'system', 'system: not a structure')
      return
    end if
    q = nint(vector(1))
    m = nint(vector(2))
    p = nint(vector(3))
    allocate (system%loads(nint(vector(4))))
    at = 4
    associate (rest => system%rest)
      rest%squares = next(m)
      rest%rates = next(m)
      rest%losses = next(m)
      rest%seen = reshape(next(m*q), [m, q])
      rest%pushed = reshape(next(m*q), [m, q])
      rest%poles = next_pairs(p)
      rest%left = reshape(next_pairs(p*q), [p, q])
      rest%right = reshape(next_pairs(p*q), [p, q])
      rest%flexibility = reshape(next(q*q), [q, q])
      rest%flexibility_rate = reshape(next(q*q), [q, q])
      rest%stiffness_at_rest = reshape(next(q*q), [q, q])
      call rest%complete()
    end associate
    n = nint(vector(at + 1))
    at = at + 1
    if (n > 0) then
      system%few%damping = reshape(next(n*n), [n, n])
      system%few%stiffness = reshape(next(n*n), [n, n])
      system%few%pushed = reshape(next(n*q), [n, q])
      system%few%seen = reshape(next(n*q), [n, q])
    end if
    do j = 1, size(system%loads)
      associate (load => system%loads(j))
        load%order = nint(vector(at + 1))
        at = at + 1
        call next_push(load%force)
        call next_push(load%base)
        load%at_rest = next_pairs(q)
        load%has_force = is_set(load%force)
        load%moves_base = is_set(load%base)
        allocate (load%varying(nint(vector(at + 1))))
        at = at + 1
        do i = 1, size(load%varying)
          call next_push(load%varying(i)%push)
          associate (law => load%varying(i)%law%program)
            n = nint(vector(at + 1))
            at = at + 1
            law%n_arguments = 1
            law%code = nint(next(n))
            law%number = next(n)
            call law%measure()
          end associate
        end do
      end associate
    end do
    call polynomial_from_vector(system%polynomial_type, vector(at + 1:), status)
    system%condensed = .true.

  contains

    function next(count) result(values)
      integer, intent(in) :: count
      real(wp) :: values(count)
      values = vector(at + 1:at + count)
      at = at + count
    end function next

    !> Complex numbers, with alternating real and imaginary parts.
    function next_pairs(count) result(values)
      integer, intent(in) :: count
      complex(wp) :: values(count)
      real(wp) :: parts(2*count)
      parts = next(2*count)
      values = cmplx(parts(1::2), parts(2::2), wp)
    end function next_pairs

    pure logical function is_set(push)
      type(push_type), intent(in) :: push
      is_set = any(abs(push%modes) > 0.0_wp) .or. any(abs(push%poles) > 0.0_wp) &
               .or. any(abs(push%flexible) > 0.0_wp)
    end function is_set

    subroutine next_push(push)
      type(push_type), intent(out) :: push
      push%modes = next_pairs(m)
      push%poles = next_pairs(p)
      push%flexible = next_pairs(q)
      push%flexible_rate = next_pairs(q)
      call system%rest%complete_push(push)
    end subroutine next_push

  end subroutine structure_from_vector

end module viscovib_structure_vector
